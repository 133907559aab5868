"""Models in environments of their own: a command of the user's works on one job folder (docs: workers)."""
