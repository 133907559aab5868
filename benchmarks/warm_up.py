"""Compile the kernels where they are not in the cache yet; prints as JSON where kernels and proxies are kept."""

import json

from f3sr import kernels

kernels.warm_up()
print(json.dumps([str(kernels.CACHE_DIR), str(kernels.cache_root() / "proxies")]))
