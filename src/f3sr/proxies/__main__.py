"""A worker that decomposes meshes: ``python -m f3sr.proxies CONFIG PARENT``."""

import sys

from f3sr.proxies.worker import serve

if __name__ == "__main__":
    serve(*sys.argv[1:])
