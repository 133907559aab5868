"""The certificate of a package: released in other people's engines, judged by other people's validators.

``clients/`` are scripts for the environments of those programs, which need not have f3sr.
"""
