"""What one photo tells of its camera without a network: focal length, gravity and, by known sizes, metres."""
