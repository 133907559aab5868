"""Goals by language models: what a model is shown, what it may answer, and how its answers become plans."""
