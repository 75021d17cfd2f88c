"""Arms in space: joints and curved sections, inverse kinematics, and the hand that moves them."""
