"""A worse network between master and slave, made to order: a proxy that both talk through."""
