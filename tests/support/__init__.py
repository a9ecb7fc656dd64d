"""What tests share: clients, peers, lines, certificates, attacks, time."""
