"""Ports on which simulated devices answer: pseudo-terminals and TCP sockets."""
