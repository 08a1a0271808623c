"""Links that carry frames: CAN, zenoh, memory."""
