"""The gallery: every run as a card, a page per run, and the comparison of runs."""
