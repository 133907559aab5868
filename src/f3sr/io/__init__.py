"""Files: the prompted-image folder and its parts read and validated, meshes read and written."""
