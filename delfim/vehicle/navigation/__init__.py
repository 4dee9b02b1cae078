"""Navigation: fixes from the sources, and the estimator between them and the loop."""
