"""A pose to go to: the way there, and how fast."""
