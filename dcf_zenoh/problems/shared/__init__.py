"""Parts that several problems use."""
