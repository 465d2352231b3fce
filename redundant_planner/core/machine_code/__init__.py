"""What `kernels` compiles with: types, and how values cross over from Python and back."""
