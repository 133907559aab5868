"""Words to tasks by rules, on a scene: which object, which way, how far, and what must come of it."""
