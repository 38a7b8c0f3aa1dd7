"""What leaves the project in forms that others read: datasets for learning policies."""
