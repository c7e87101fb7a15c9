"""Controllers join a problem and an algorithm once per control step."""
