"""Lines at which devices answer: pseudo-terminals, sockets."""
