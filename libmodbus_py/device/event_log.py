"""
The notes of one device about one line: counters, event log, listen-only mode.

This is the memory behind functions 8, 11 and 12: MODBUS Application Protocol V1.1b3,
sections 6.8-6.10; order of counting: MODBUS over Serial Line V1.02, appendix A. Left open
there: counters wrap to 0; an exchange without an exception is an event, also of function 12,
but not of function 11; a broadcast that does not write counts as a message without a response.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

from ..protocol import errors, pdu
from ..protocol.framing import LINE_FEED

# Counters are plain numbers, too: an enumeration would take most of the time of a note.
COUNTERS = range(pdu.SubFunction.BUS_MESSAGE_COUNT, pdu.SubFunction.BUS_CHARACTER_OVERRUN_COUNT + 1)
SERVER_MESSAGES = int(pdu.SubFunction.SERVER_MESSAGE_COUNT)
BUS_MESSAGES = int(pdu.SubFunction.BUS_MESSAGE_COUNT)
EVENT_COUNT = -1  # no sub-function reads it
EVENT_COUNTER = pdu.ReadCommEventCounter.function


class Event:
    """Bits of the event bytes (section 6.10), also plain numbers; the last two are whole bytes."""

    RECEIVED, BROADCAST, LISTEN_ONLY, OVERRUN, COMMUNICATION_ERROR = 0x80, 0x40, 0x20, 0x10, 0x02
    SENT, SENT_NAK, SENT_BUSY, SENT_FAILURE, SENT_REFUSAL = 0x40, 0x08, 0x04, 0x02, 0x01
    ENTERED_LISTEN_ONLY, RESTARTED = 0x04, 0x00


# Exception code -> the bit of the send event.
SENT_EXCEPTIONS = {
    **dict.fromkeys((1, 2, 3), Event.SENT_REFUSAL),
    errors.ServerDeviceFailure.code: Event.SENT_FAILURE,
    errors.Acknowledge.code: Event.SENT_BUSY,
    errors.ServerDeviceBusy.code: Event.SENT_BUSY,
    errors.NegativeAcknowledge.code: Event.SENT_NAK,
}

# Exception code -> the counter of its own.
COUNTED_EXCEPTIONS = {
    errors.ServerDeviceBusy.code: pdu.SubFunction.SERVER_BUSY_COUNT,
    errors.NegativeAcknowledge.code: pdu.SubFunction.SERVER_NAK_COUNT,
}


class EventLog:
    """
    The counters and events of one device on one line; `is_serial`: it can be silenced.

    It does not execute or answer while `listen_only`; `delimiter` (0..127) ends its ASCII frames.
    """

    __slots__ = ("_counters", "_events", "delimiter", "is_serial", "listen_only")

    def __init__(self, *, is_serial: bool) -> None:
        self.is_serial: bool = is_serial
        self.delimiter: int = LINE_FEED
        self.listen_only: bool = False
        self._events: deque[int] = deque(maxlen=pdu.ReadCommEventLog.max_events)
        self._counters: dict[int, int] = {}
        self.clear_counters()

    def of_connection(self) -> EventLog:
        """Return a log that shares counters and events, but has its own mode and delimiter."""
        own = EventLog(is_serial=self.is_serial)
        own._events, own._counters = self._events, self._counters
        return own

    # --- events on the line; those of each request call no other method --------------------

    def note_frame(self) -> None:
        """Count a valid frame on a serial line, for any unit; on TCP one that is not a request."""
        counters = self._counters
        counters[BUS_MESSAGES] = counters[BUS_MESSAGES] + 1 & 0xFFFF

    def note_damage(self, *, overrun: bool) -> None:
        if overrun:
            self._count(pdu.SubFunction.BUS_CHARACTER_OVERRUN_COUNT)
        self._count(pdu.SubFunction.BUS_COMMUNICATION_ERROR_COUNT)
        self._log(Event.RECEIVED | Event.COMMUNICATION_ERROR | (Event.OVERRUN if overrun else 0))

    def note_request(self, *, broadcast: bool) -> None:
        """Count a request for this device, which is processed next; on TCP with its frame."""
        counters = self._counters
        if not self.is_serial:
            counters[BUS_MESSAGES] = counters[BUS_MESSAGES] + 1 & 0xFFFF
        counters[SERVER_MESSAGES] = counters[SERVER_MESSAGES] + 1 & 0xFFFF
        event = Event.RECEIVED | Event.BROADCAST if broadcast else Event.RECEIVED
        self._events.appendleft(event | Event.LISTEN_ONLY if self.listen_only else event)

    def note_response(self, request: bytes, response: bytes, *, silent: bool) -> None:
        """Note that a request has been processed; its response is empty if it was not executed."""
        is_refusal = len(response) == 2 and response[0] & 0x80
        if is_refusal:
            self._count(pdu.SubFunction.BUS_EXCEPTION_ERROR_COUNT)
            counter = COUNTED_EXCEPTIONS.get(response[1])
            if counter is not None and not silent:
                self._count(counter)
        elif response and request[0] != EVENT_COUNTER:
            self._counters[EVENT_COUNT] = self._counters[EVENT_COUNT] + 1 & 0xFFFF
        if silent:
            self._count(pdu.SubFunction.SERVER_NO_RESPONSE_COUNT)
        event = (
            Event.SENT | SENT_EXCEPTIONS.get(response[1], 0)
            if is_refusal and not silent
            else Event.SENT
        )
        self._events.appendleft(event | Event.LISTEN_ONLY if self.listen_only else event)

    def note_exchanges(self, requests: int, refusals: int, latest: Iterable[int]) -> None:
        """Note requests that C has answered; `latest`: whether each was refused, oldest first."""
        self._count(pdu.SubFunction.BUS_MESSAGE_COUNT, requests)
        self._count(pdu.SubFunction.SERVER_MESSAGE_COUNT, requests)
        self._count(pdu.SubFunction.BUS_EXCEPTION_ERROR_COUNT, refusals)
        self._count(EVENT_COUNT, requests - refusals)
        for was_refused in latest:
            self._log(Event.RECEIVED)
            self._log(Event.SENT | Event.SENT_REFUSAL if was_refused else Event.SENT)

    def _count(self, counter: int, times: int = 1) -> None:
        self._counters[counter] = self._counters[counter] + times & 0xFFFF

    def _log(self, event: int) -> None:
        self._events.appendleft(event | Event.LISTEN_ONLY if self.listen_only else event)

    # --- functions 8, 11 and 12 -------------------------------------------------------------

    def counter(self, counter: pdu.SubFunction) -> int:
        return self._counters[counter]

    def clear_counters(self) -> None:
        """Clear all counters, but neither the log nor listen-only mode (sub-function 10)."""
        # In place, because other connections of the line share the counters.
        self._counters.update(dict.fromkeys((*COUNTERS, EVENT_COUNT), 0))

    def clear_overrun(self) -> None:
        self._counters[pdu.SubFunction.BUS_CHARACTER_OVERRUN_COUNT] = 0

    def restart(self, *, clear_log: bool) -> None:
        """Reset to the state after power-up, except for the log if it is kept (sub-function 1)."""
        self.clear_counters()
        self.listen_only = False
        self.delimiter = LINE_FEED
        if clear_log:
            self._events.clear()
        self._events.appendleft(Event.RESTARTED)

    def enter_listen_only(self) -> None:
        self._events.appendleft(Event.ENTERED_LISTEN_ONLY)
        self.listen_only = True

    def read_event_counter(self) -> pdu.CommEventCounter:
        """Answer function 11; no program command ever runs here, so the status is 0."""
        return pdu.CommEventCounter(0, self._counters[EVENT_COUNT])

    def read_event_log(self) -> pdu.CommEventLog:
        messages = self._counters[pdu.SubFunction.BUS_MESSAGE_COUNT]
        return pdu.CommEventLog(0, self._counters[EVENT_COUNT], messages, bytes(self._events))
