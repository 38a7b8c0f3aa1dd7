"""What is stale in a store, why, what doing it again would cost; and exactly that done."""
