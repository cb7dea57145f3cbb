"""The wire: frames, message layouts, sample rows in SI, boot clocks and sessions."""
