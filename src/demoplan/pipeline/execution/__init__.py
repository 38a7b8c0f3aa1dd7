"""Plans carried out by simulated robots: watched, diagnosed, planned anew, evaluated in batches."""
