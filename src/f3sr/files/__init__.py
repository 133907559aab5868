"""Bytes from outside to checked values: files of limited size, arrays, JSON."""
