"""Plans: by any method, again from a state under way, and with a receding horizon."""
