"""What everything else is computed with: transforms, the camera, meshes, bounded least squares."""
