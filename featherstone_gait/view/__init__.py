"""Show robots and trajectories: plots, stick figures, pages that play a motion, movies, and reports."""
