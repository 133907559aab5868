"""The one MuJoCo model of the product, and what is run with it."""
