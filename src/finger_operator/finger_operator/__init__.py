"""Core of the guided study and the operator's page, and the nodes around them."""
