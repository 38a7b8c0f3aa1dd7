"""Tables and domain versions on disk, by content."""
