"""Filters of packets in classic BPF, which the kernel applies to a socket."""

import ctypes
import socket
import struct
from collections.abc import Collection
from ipaddress import IPv4Network, IPv6Network

Network = IPv4Network | IPv6Network
# Of a filter. The kernel allows a socket 20 480 (net.core.optmem_max before Linux 6.8), in which a
# new filter stands beside the one that it replaces: 185 sources of IPv4, 60 of IPv6
FILTER_BYTES = 9000
PORTS_MAX = 400  # in it, for each source on this machine
_ATTACH_FILTER, _DETACH_FILTER = 26, 27
_LOAD, _LOAD_HALF, _AND, _EQUAL, _JUMP, _RETURN = 0x20, 0x28, 0x54, 0x15, 0x05, 0x06  # classic BPF
_STORE, _LOAD_STORED = 0x02, 0x60
_STEP_BYTES = {_LOAD: 72, _LOAD_HALF: 112, _EQUAL: 16, _RETURN: 16}  # as eBPF; others 8
_JUMP_MAX = 200  # steps that a test may skip, of 255
_NETWORK_HEADER = 0xFFF00000  # place of the IP header; places from 0 are of the TCP header
_PASS = 0xFFFFFFFF


def build_filter(version: int, blocked: dict[Network, bool], ports: Collection[int]) -> list[bytes]:
    """Return a filter in classic BPF of the newest sources that fit into `FILTER_BYTES`.

    Of sources on this machine, some ports pass.
    """
    offset = _NETWORK_HEADER + (12 if version == 4 else 8)  # of the source address
    address = [
        step
        for word in range(1 if version == 4 else 4)
        for step in (_build_instruction(_LOAD, offset + 4 * word), _build_instruction(_STORE, word))
    ]
    program: list[bytes] = []
    for source, local in reversed(blocked.items()):
        if source.version == version:
            drop = _build_drop(source, sorted(ports)[:PORTS_MAX] if local else [])
            if measure_filter([*address, *program, *drop]) > FILTER_BYTES:
                break
            program += drop
    return [*address, *program, _build_instruction(_RETURN, _PASS)] if program else []


def _build_drop(source: Network, ports: list[int]) -> list[bytes]:
    """Return the steps that drop the packets of a source, whose address is stored; ports pass."""
    steps = [_build_instruction(_LOAD_HALF, 0)] * bool(ports)
    for begin in range(0, len(ports), _JUMP_MAX):
        some = ports[begin : begin + _JUMP_MAX]
        steps += [_build_instruction(_EQUAL, port, len(some) - k, 0) for k, port in enumerate(some)]
        steps += [_build_instruction(_JUMP, 1), _build_instruction(_RETURN, _PASS)]
    steps.append(_build_instruction(_RETURN, 0))
    for word in reversed(range(source.max_prefixlen // 32)):
        value, mask = (
            int.from_bytes(x.packed[4 * word : 4 * word + 4]) for x in (source[0], source.netmask)
        )
        if mask:
            part = [_build_instruction(_AND, mask)] * (mask != _PASS)
            steps = [
                _build_instruction(_LOAD_STORED, word),
                *part,
                _build_instruction(_EQUAL, value, 1, 0),
                _build_instruction(_JUMP, len(steps)),
                *steps,
            ]  # fmt: skip
    return steps


def measure_filter(program: list[bytes]) -> int:
    """Return how much memory of a socket a filter takes in the kernel, as eBPF [B]; measured."""
    return sum(_STEP_BYTES.get(struct.unpack_from("H", step)[0], 8) for step in program)


def _build_instruction(code: int, value: int, if_true: int = 0, if_false: int = 0) -> bytes:
    return struct.pack("HBBI", code, if_true, if_false, value)


def filter_packets(listening: socket.socket, program: list[bytes]) -> None:
    """Let the kernel drop packets to a listening socket; all pass if `program` is empty."""
    if program:
        steps = ctypes.create_string_buffer(b"".join(program))
        filter_program = struct.pack("HP", len(program), ctypes.addressof(steps))
        listening.setsockopt(socket.SOL_SOCKET, _ATTACH_FILTER, filter_program)
    else:
        listening.setsockopt(socket.SOL_SOCKET, _DETACH_FILTER, 0)


DROP_ALL = [_build_instruction(_RETURN, 0)]
"""The filter that lets nothing pass."""
