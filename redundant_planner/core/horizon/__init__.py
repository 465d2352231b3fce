"""The shortest joint path over the time ahead (Eqs. 11 and 12)."""
