"""What shows: rerun recordings and the HTML report."""
