"""Scenes as tools of the Model Context Protocol: any agent may reconstruct, list, simulate, judge and film."""
