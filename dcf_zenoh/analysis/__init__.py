"""What is computed from recorded runs: metrics, comparison, link health, replay, explanation, central solution."""
