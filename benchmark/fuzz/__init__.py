"""Random and mutated input of every kind, and a count of what it does to the package."""
