"""Who may do what on the bus: identities, and rules made from the tables of topics and services."""
