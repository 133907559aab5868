"""What the report and the player are made of: one document without a network, its markup, pictures and 3-D view."""
