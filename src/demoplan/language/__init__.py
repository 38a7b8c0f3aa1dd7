"""Types, predicates, atoms, operators, domains, problems and plans, as values; and their PDDL text."""
