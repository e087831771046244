"""The certificate: proven lower bounds on the energy of any motion of the discretised problem."""
