"""A page in the browser: see an arm, drive it, put obstacles in its way (docs/playground.md)."""
