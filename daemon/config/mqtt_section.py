"""``[mqtt]``: the broker of a plant, which is told and never asked."""

import ipaddress
from importlib.util import find_spec
from typing import Annotated, Self

from pydantic import AfterValidator, Field, model_validator

from daemon.config.section import Section, absolute


class MqttSection(Section):
    """A broker that is told state and runs. Nothing is taken from it; needs the extra cellward[mqtt]."""

    enabled: bool = Field(default=False, description="true: the broker is told")
    host: str = Field(default="127.0.0.1", min_length=1, max_length=253, description="address of the broker")
    port: int = Field(default=1883, ge=1, le=65535, description="1883, or 8883 with TLS")
    topic: str = Field(
        default="cellward",
        pattern=r"^[^+#\x00$/][^+#\x00]*$",
        max_length=200,
        description="all topics begin with it, then with the cell's name",
    )
    user: str | None = Field(default=None, min_length=1, max_length=200, description="name at the broker")
    password_file: Annotated[str, AfterValidator(absolute)] | None = Field(
        default=None, description="file with the password alone, readable by the daemon"
    )
    tls_ca: Annotated[str, AfterValidator(absolute)] | None = Field(
        default=None, description="certificates (PEM) that sign the broker's; with it the connection is TLS"
    )
    tls_cert: Annotated[str, AfterValidator(absolute)] | None = Field(
        default=None, description="our certificate (PEM), where the broker asks for one"
    )
    tls_key: Annotated[str, AfterValidator(absolute)] | None = Field(
        default=None, description="its key (PEM)"
    )
    state_every_s: float = Field(
        default=1.0, ge=0.2, le=60.0, description="a changing state is told no more often than this"
    )

    @model_validator(mode="after")
    def _is_installed(self) -> Self:
        if self.enabled and find_spec("aiomqtt") is None:
            raise ValueError(
                "telling a broker needs aiomqtt: install the extra cellward[mqtt], or leave it out"
            )
        return self

    @model_validator(mode="after")
    def _guards_its_secrets(self) -> Self:
        if (self.user is None) != (self.password_file is None):
            raise ValueError("user and password_file belong together: give both or neither")
        if (self.tls_cert is None) != (self.tls_key is None):
            raise ValueError("tls_cert and tls_key belong together: give both or neither")
        if self.tls_ca is None and (self.tls_cert is not None or (self.user and not self._is_here())):
            raise ValueError("a password or a certificate goes over TLS alone: give tls_ca")
        return self

    def _is_here(self) -> bool:
        try:
            return self.host == "localhost" or ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return False
