"""Compile the kernels where they are not in the cache yet; prints as JSON where kernels and proxies are kept."""

import json

from f3sr.runtime import kernels
from f3sr.runtime.cache_folder import within

kernels.warm_up()
print(json.dumps([str(kernels.kernel_folder()), str(within("proxies"))]))
