"""What processes need of the machine: clocks, scheduling, files, child processes."""
