"""Arrangements of calls: what a command or a flow runs. No logic of its own."""
