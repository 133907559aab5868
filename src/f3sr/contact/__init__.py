"""Bodies that touch: polytopes, contact patches, balance of forces, stability, and the least moves that give it."""
