"""A dataset of scenes: its folder, records, index, and what is made of them."""
