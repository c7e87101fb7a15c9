"""Analysis of recorded runs: metrics, comparison, link health, replay, explanation, central solution."""
