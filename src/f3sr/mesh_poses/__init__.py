"""Where meshes of generators stand in the photo: readings of given poses, and orientations by masks."""
