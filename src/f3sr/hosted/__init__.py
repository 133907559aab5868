"""Meshes by services over HTTP: what is sent, how a job is waited for, and what of the replies is accepted."""
