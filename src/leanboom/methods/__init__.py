"""Methods that plan a motion: the search of `dp`, and the baselines of the papers."""
