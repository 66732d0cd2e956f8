from .access import (
    MIN_TOKEN_CHARS as MIN_TOKEN_CHARS,
    Access as Access,
    is_loopback_host as is_loopback_host,
)
from .access_middleware import AccessMiddleware as AccessMiddleware
from .allowance import Allowance as Allowance
from .login_throttle import LoginThrottle as LoginThrottle
from .server import (
    MAX_MESSAGE_CHARS as MAX_MESSAGE_CHARS,
    open_socket as open_socket,
    serve as serve,
    server_of as server_of,
)
