"""The page in the browser: live control, and the gallery of runs."""
