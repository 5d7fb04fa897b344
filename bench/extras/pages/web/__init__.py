"""What all pages of the bench share: the local server, its guards, and the stream of server-sent events."""
