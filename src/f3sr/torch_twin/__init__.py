"""The silhouette integrals in torch: what a GPU computes, and the twin that checks the compiled kernels."""
