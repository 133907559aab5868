"""What the report and the player share: one document without a network, its template, pictures and 3-D view."""
