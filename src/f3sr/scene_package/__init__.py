"""The scene package: scene.json, and the folder that holds it, written whole and read back checked."""
