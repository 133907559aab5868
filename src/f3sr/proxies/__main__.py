"""The subprocess in which one mesh is decomposed: ``python -m f3sr.proxies CONFIG PARENT``."""

import sys

from f3sr.proxies.worker import work

if __name__ == "__main__":
    work(*sys.argv[1:])
