"""The experiment of Phee et al. 2009 on simulated rigs, for the paper's method and for ours."""
