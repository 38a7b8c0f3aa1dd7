"""What people write: datasets, mappings and vocabularies, parsed from text into values that cannot be wrong."""
