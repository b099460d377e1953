"""How fast the engines are, measured so that anyone can repeat it."""
