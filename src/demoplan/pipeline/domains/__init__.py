"""From transitions, or symbolic traces, to versions of domains; their plans, and how good they are."""
