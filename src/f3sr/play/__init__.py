"""Goals played: launches tried, judged and written."""
