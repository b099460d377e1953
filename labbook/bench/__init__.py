"""How fast the backends are, measured so that anyone can repeat it."""
