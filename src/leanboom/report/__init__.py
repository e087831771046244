"""What is written for people: pages, figures, facts and the run folder."""
