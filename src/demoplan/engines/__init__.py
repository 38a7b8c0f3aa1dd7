"""What runs: Fast Downward and MuJoCo."""
