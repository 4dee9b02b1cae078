"""Orders: what each does at the helm, and who else than an operator gives them."""
