"""The live service: joins link, navigation and publish; owns threads, queues and shutdown."""
