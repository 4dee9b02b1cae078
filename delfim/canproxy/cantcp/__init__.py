"""CAN over TCP for any number of clients, spoken as socketcand or as slcan (docs/cantcpd.md)."""
