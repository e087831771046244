"""Reports: pages, figures, facts and the run folder."""
