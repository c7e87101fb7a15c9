"""Reading of a fleet file: from its text to a validated specification."""
