"""The arrows: one pure function from declared tables to a declared table per module."""
