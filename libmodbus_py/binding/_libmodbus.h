/* What Python may call, in the order of modbus.h, modbus-tcp.h, modbus-rtu.h. */

#define MODBUS_FC_READ_COILS ...
#define MODBUS_FC_READ_DISCRETE_INPUTS ...
#define MODBUS_FC_READ_HOLDING_REGISTERS ...
#define MODBUS_FC_READ_INPUT_REGISTERS ...
#define MODBUS_FC_WRITE_SINGLE_COIL ...
#define MODBUS_FC_WRITE_SINGLE_REGISTER ...
#define MODBUS_FC_READ_EXCEPTION_STATUS ...
#define MODBUS_FC_WRITE_MULTIPLE_COILS ...
#define MODBUS_FC_WRITE_MULTIPLE_REGISTERS ...
#define MODBUS_FC_REPORT_SLAVE_ID ...
#define MODBUS_FC_MASK_WRITE_REGISTER ...
#define MODBUS_FC_WRITE_AND_READ_REGISTERS ...

#define MODBUS_MAX_READ_BITS ...
#define MODBUS_MAX_WRITE_BITS ...
#define MODBUS_MAX_READ_REGISTERS ...
#define MODBUS_MAX_WRITE_REGISTERS ...
#define MODBUS_MAX_WR_WRITE_REGISTERS ...
#define MODBUS_MAX_WR_READ_REGISTERS ...
#define MODBUS_MAX_PDU_LENGTH ...
#define MODBUS_MAX_ADU_LENGTH ...
#define MODBUS_TCP_MAX_ADU_LENGTH ...
#define MODBUS_RTU_MAX_ADU_LENGTH ...
#define MODBUS_BROADCAST_ADDRESS ...
#define MODBUS_TCP_DEFAULT_PORT ...
#define MODBUS_TCP_SLAVE ...

#define MODBUS_EXCEPTION_ILLEGAL_FUNCTION ...
#define MODBUS_EXCEPTION_ILLEGAL_DATA_ADDRESS ...
#define MODBUS_EXCEPTION_ILLEGAL_DATA_VALUE ...
#define MODBUS_EXCEPTION_SLAVE_OR_SERVER_FAILURE ...
#define MODBUS_EXCEPTION_ACKNOWLEDGE ...
#define MODBUS_EXCEPTION_SLAVE_OR_SERVER_BUSY ...
#define MODBUS_EXCEPTION_NEGATIVE_ACKNOWLEDGE ...
#define MODBUS_EXCEPTION_MEMORY_PARITY ...
#define MODBUS_EXCEPTION_NOT_DEFINED ...
#define MODBUS_EXCEPTION_GATEWAY_PATH ...
#define MODBUS_EXCEPTION_GATEWAY_TARGET ...
#define MODBUS_EXCEPTION_MAX ...

#define MODBUS_ENOBASE ...
#define EMBXILFUN ...
#define EMBXILADD ...
#define EMBXILVAL ...
#define EMBXSFAIL ...
#define EMBXACK ...
#define EMBXSBUSY ...
#define EMBXNACK ...
#define EMBXMEMPAR ...
#define EMBXGPATH ...
#define EMBXGTAR ...
#define EMBBADCRC ...
#define EMBBADDATA ...
#define EMBBADEXC ...
#define EMBUNKEXC ...
#define EMBMDATA ...
#define EMBBADSLAVE ...

#define MODBUS_RTU_RS232 ...
#define MODBUS_RTU_RS485 ...
#define MODBUS_RTU_RTS_NONE ...
#define MODBUS_RTU_RTS_UP ...
#define MODBUS_RTU_RTS_DOWN ...

extern const unsigned int libmodbus_version_major;
extern const unsigned int libmodbus_version_minor;
extern const unsigned int libmodbus_version_micro;

typedef ... modbus_t;

typedef struct {
    int nb_bits;
    int start_bits;
    int nb_input_bits;
    int start_input_bits;
    int nb_input_registers;
    int start_input_registers;
    int nb_registers;
    int start_registers;
    uint8_t *tab_bits;
    uint8_t *tab_input_bits;
    uint16_t *tab_input_registers;
    uint16_t *tab_registers;
    ...;
} modbus_mapping_t;

typedef enum {
    MODBUS_ERROR_RECOVERY_NONE,
    MODBUS_ERROR_RECOVERY_LINK,
    MODBUS_ERROR_RECOVERY_PROTOCOL,
    ...
} modbus_error_recovery_mode;

int modbus_set_slave(modbus_t *ctx, int slave);
int modbus_get_slave(modbus_t *ctx);
int modbus_set_error_recovery(modbus_t *ctx, modbus_error_recovery_mode error_recovery);
int modbus_set_socket(modbus_t *ctx, int s);
int modbus_get_socket(modbus_t *ctx);
int modbus_get_response_timeout(modbus_t *ctx, uint32_t *to_sec, uint32_t *to_usec);
int modbus_set_response_timeout(modbus_t *ctx, uint32_t to_sec, uint32_t to_usec);
int modbus_get_byte_timeout(modbus_t *ctx, uint32_t *to_sec, uint32_t *to_usec);
int modbus_set_byte_timeout(modbus_t *ctx, uint32_t to_sec, uint32_t to_usec);
int modbus_get_indication_timeout(modbus_t *ctx, uint32_t *to_sec, uint32_t *to_usec);
int modbus_set_indication_timeout(modbus_t *ctx, uint32_t to_sec, uint32_t to_usec);
int modbus_get_header_length(modbus_t *ctx);
int modbus_connect(modbus_t *ctx);
void modbus_close(modbus_t *ctx);
void modbus_free(modbus_t *ctx);
int modbus_flush(modbus_t *ctx);
int modbus_set_debug(modbus_t *ctx, int flag);
const char *modbus_strerror(int errnum);

int modbus_read_bits(modbus_t *ctx, int addr, int nb, uint8_t *dest);
int modbus_read_input_bits(modbus_t *ctx, int addr, int nb, uint8_t *dest);
int modbus_read_registers(modbus_t *ctx, int addr, int nb, uint16_t *dest);
int modbus_read_input_registers(modbus_t *ctx, int addr, int nb, uint16_t *dest);
int modbus_write_bit(modbus_t *ctx, int coil_addr, int status);
int modbus_write_register(modbus_t *ctx, int reg_addr, const uint16_t value);
int modbus_write_bits(modbus_t *ctx, int addr, int nb, const uint8_t *data);
int modbus_write_registers(modbus_t *ctx, int addr, int nb, const uint16_t *data);
int modbus_mask_write_register(modbus_t *ctx, int addr, uint16_t and_mask, uint16_t or_mask);
int modbus_write_and_read_registers(modbus_t *ctx, int write_addr, int write_nb,
                                    const uint16_t *src, int read_addr, int read_nb,
                                    uint16_t *dest);
int modbus_report_slave_id(modbus_t *ctx, int max_dest, uint8_t *dest);

modbus_mapping_t *modbus_mapping_new_start_address(
    unsigned int start_bits, unsigned int nb_bits,
    unsigned int start_input_bits, unsigned int nb_input_bits,
    unsigned int start_registers, unsigned int nb_registers,
    unsigned int start_input_registers, unsigned int nb_input_registers);
modbus_mapping_t *modbus_mapping_new(int nb_bits, int nb_input_bits,
                                     int nb_registers, int nb_input_registers);
void modbus_mapping_free(modbus_mapping_t *mb_mapping);

int modbus_send_raw_request(modbus_t *ctx, const uint8_t *raw_req, int raw_req_length);
int modbus_receive(modbus_t *ctx, uint8_t *req);
int modbus_receive_confirmation(modbus_t *ctx, uint8_t *rsp);
int modbus_reply(modbus_t *ctx, const uint8_t *req, int req_length, modbus_mapping_t *mb_mapping);
int modbus_reply_exception(modbus_t *ctx, const uint8_t *req, unsigned int exception_code);

void modbus_set_bits_from_byte(uint8_t *dest, int idx, const uint8_t value);
void modbus_set_bits_from_bytes(uint8_t *dest, int idx, unsigned int nb_bits,
                                const uint8_t *tab_byte);
uint8_t modbus_get_byte_from_bits(const uint8_t *src, int idx, unsigned int nb_bits);
float modbus_get_float(const uint16_t *src);
float modbus_get_float_abcd(const uint16_t *src);
float modbus_get_float_dcba(const uint16_t *src);
float modbus_get_float_badc(const uint16_t *src);
float modbus_get_float_cdab(const uint16_t *src);
void modbus_set_float(float f, uint16_t *dest);
void modbus_set_float_abcd(float f, uint16_t *dest);
void modbus_set_float_dcba(float f, uint16_t *dest);
void modbus_set_float_badc(float f, uint16_t *dest);
void modbus_set_float_cdab(float f, uint16_t *dest);

modbus_t *modbus_new_tcp(const char *ip_address, int port);
int modbus_tcp_listen(modbus_t *ctx, int nb_connection);
int modbus_tcp_accept(modbus_t *ctx, int *s);
modbus_t *modbus_new_tcp_pi(const char *node, const char *service);
int modbus_tcp_pi_listen(modbus_t *ctx, int nb_connection);
int modbus_tcp_pi_accept(modbus_t *ctx, int *s);

modbus_t *modbus_new_rtu(const char *device, int baud, char parity, int data_bit, int stop_bit);
int modbus_rtu_set_serial_mode(modbus_t *ctx, int mode);
int modbus_rtu_get_serial_mode(modbus_t *ctx);
int modbus_rtu_set_rts(modbus_t *ctx, int mode);
int modbus_rtu_get_rts(modbus_t *ctx);
int modbus_rtu_set_custom_rts(modbus_t *ctx, void (*set_rts)(modbus_t *ctx, int on));
int modbus_rtu_set_rts_delay(modbus_t *ctx, int us);
int modbus_rtu_get_rts_delay(modbus_t *ctx);

#define MODBUS_QUIRK_NONE ...
#define MODBUS_QUIRK_MAX_SLAVE ...
#define MODBUS_QUIRK_REPLY_TO_BROADCAST ...
#define MODBUS_QUIRK_ALL ...

/* Newer than 3.1.6: -1 with ENOSYS where the loaded library lacks them. */
int modbus_enable_quirks(modbus_t *ctx, unsigned int quirks_mask);
int modbus_disable_quirks(modbus_t *ctx, unsigned int quirks_mask);
int modbus_send_raw_request_tid(modbus_t *ctx, const uint8_t *raw_req, int raw_req_length, int tid);
int modbus_proxy(modbus_t *frontend_ctx, modbus_t *backend_ctx, const uint8_t *req, int req_length);

/* Ours: answer_chunk.c. */
typedef struct {
    uint32_t requests;
    uint32_t refused;
    uint8_t was_refused[...];
} tally_t;

#define COILS ...
#define DISCRETE_INPUTS ...
#define HOLDING_REGISTERS ...
#define INPUT_REGISTERS ...

typedef struct {
    int count;
    const uint16_t *edges;
} runs_t;

typedef struct {
    modbus_mapping_t tables;
    runs_t ranges[...];
} mapping_t;

typedef struct {
    uint32_t functions;
    runs_t reads[...];
    runs_t writes[...];
} watched_t;

typedef struct {
    modbus_t *context;
    int outlet;
    uint8_t *answers;
    int room;
    int size;
    int requests;
    int refused;
    ...;
} replier_t;

int answer_chunk(replier_t *replier, mapping_t *mapping, const watched_t *watched,
                 tally_t *tally, int unit, const uint8_t *data, int start, int end);

/* Ours: exchange.c. */
typedef struct {
    modbus_t *context;
    uint8_t answer[...];
    int error;
} exchange_t;

enum { NOTHING, NOT_SENT, FAILED, ... };

int exchange(exchange_t *exchange, int descriptor, int waker, const uint8_t *adu, int size,
             double timeout);
