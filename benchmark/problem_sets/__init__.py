"""Problems with a start, a goal and obstacles in between: read from files, or made from a seed."""
