"""Records over zenoh: sessions that find each other, publishers, subscribers, the wire schema."""
