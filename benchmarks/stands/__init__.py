"""The other sides of measurements: worlds, controllers, clients and peers, most of them as processes of their own."""
