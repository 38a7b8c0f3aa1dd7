"""What people write: datasets, mappings and vocabularies, from text into values that cannot be wrong."""
