"""The paper's experiment, Eq. 17 and its method to the letter."""
