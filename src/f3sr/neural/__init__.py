"""Back ends that run a network in this process, each with the pre- and post-processing of its authors.

One module per family of models. torch and transformers (``pip install 'f3sr[models]'``) are imported on first use.
Photos and answers are in pixels of the photo, (0, 0) the corner of its first pixel; lengths are metres.
"""
