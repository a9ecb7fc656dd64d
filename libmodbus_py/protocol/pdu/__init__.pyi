"""
The public names of this folder, each once: type checkers read this file, and so does Python.
"""

from .files import RECORDS_PER_FILE as RECORDS_PER_FILE
from .files import ReadFifoQueue as ReadFifoQueue
from .files import ReadFileRecords as ReadFileRecords
from .files import WriteFileRecords as WriteFileRecords
from .function_codes import REQUESTS as REQUESTS
from .function_codes import decode_request as decode_request
from .function_codes import register as register
from .function_codes import request_length as request_length
from .function_codes import response_length as response_length
from .interface import DeviceIdentification as DeviceIdentification
from .interface import EncapsulatedTransport as EncapsulatedTransport
from .interface import IdentificationPage as IdentificationPage
from .interface import RawRequest as RawRequest
from .interface import ReadDeviceIdentification as ReadDeviceIdentification
from .reads import ReadCoils as ReadCoils
from .reads import ReadDiscreteInputs as ReadDiscreteInputs
from .reads import ReadHoldingRegisters as ReadHoldingRegisters
from .reads import ReadInputRegisters as ReadInputRegisters
from .request import MAX_PDU as MAX_PDU
from .request import LengthRule as LengthRule
from .request import Request as Request
from .request import counted as counted
from .request import fixed as fixed
from .request import unknown_length as unknown_length
from .serial import CommEventCounter as CommEventCounter
from .serial import CommEventLog as CommEventLog
from .serial import Diagnostics as Diagnostics
from .serial import ReadCommEventCounter as ReadCommEventCounter
from .serial import ReadCommEventLog as ReadCommEventLog
from .serial import ReadExceptionStatus as ReadExceptionStatus
from .serial import ReportServerId as ReportServerId
from .serial import ServerId as ServerId
from .serial import SubFunction as SubFunction
from .writes import MaskWriteRegister as MaskWriteRegister
from .writes import ReadWriteRegisters as ReadWriteRegisters
from .writes import WriteCoil as WriteCoil
from .writes import WriteCoils as WriteCoils
from .writes import WriteRegister as WriteRegister
from .writes import WriteRegisters as WriteRegisters
