"""From the text of a fleet file to a validated specification."""
