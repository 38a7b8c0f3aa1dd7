"""MCAP files and ROS bags: into sample tables, and out of them."""
