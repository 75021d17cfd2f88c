"""Experiments with people: designs, psychometric functions, tables of trials, sessions."""
