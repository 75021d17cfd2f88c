"""Arms whose tendons pass joints: travel, friction, torque and force through all of them."""
