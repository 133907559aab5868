"""Goals: from plain words to a checked plan, a physics rollout and a verdict."""
