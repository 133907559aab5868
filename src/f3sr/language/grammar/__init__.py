"""Words to requests: plain English taken apart, before any scene is looked at."""
