"""A package from outside that adds a measure, a law and a backend to labbook, by its entry points alone."""
