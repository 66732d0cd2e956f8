from .access import MIN_TOKEN_CHARS as MIN_TOKEN_CHARS, is_loopback_host as is_loopback_host
from .application import console_app as console_app
from .server import open_socket as open_socket, serve as serve
