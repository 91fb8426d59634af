"""The other sides of measurements: worlds, controllers, clients and peers, most of them processes of their own."""
