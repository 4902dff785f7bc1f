"""Words for a port of a controller that does not answer.

From PolyScope 5.10 on each service is switched on by itself, under Settings, Security, Services (Universal
Robots' client library, page "Robot setup").
"""

_SERVICES = {
    29999: "Dashboard Server",
    30001: "Primary Client Interface",
    30003: "Real-Time Client Interface",
    30004: "RTDE",
}


def why(exc: BaseException, port: int) -> str:
    """What the system said, and for a refused connection the service that may be switched off."""
    if isinstance(exc, ConnectionRefusedError):
        return (
            f"{exc}; the controller's service {_SERVICES[port]} may be off (PolyScope 5.10 and later:"
            " Settings, Security, Services)"
        )
    return str(exc) or "no answer in time"
