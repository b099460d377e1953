"""A package from outside: a contact law, a wall, a start, a measure, a flow law, a paper and a backend."""
