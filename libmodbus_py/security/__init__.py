"""
Modbus Security: who may talk, proven by certificates. No socket.
"""
