"""What the null space is for: J⁺, P, Eq. 2 and the criteria of Eq. 18."""
