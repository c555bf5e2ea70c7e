"""Which effects are missing together: hypotheses that grow by one effect a round, side by side."""
