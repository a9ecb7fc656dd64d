/* Compiled in front of the wrappers that cffi generates from _libmodbus.h. */

#include <errno.h>
#include <modbus/modbus.h>

/* Functions newer than libmodbus 3.1.6. Weak, so that one build loads on
 * every libmodbus.so.5; a call that the loaded library lacks answers ENOSYS. */
extern int modbus_enable_quirks(modbus_t *ctx, unsigned int quirks_mask) __attribute__((weak));
extern int modbus_disable_quirks(modbus_t *ctx, unsigned int quirks_mask) __attribute__((weak));
extern int modbus_send_raw_request_tid(modbus_t *ctx, const uint8_t *raw_req, int raw_req_length,
                                       int tid) __attribute__((weak));
extern int modbus_proxy(modbus_t *frontend_ctx, modbus_t *backend_ctx, const uint8_t *req,
                        int req_length) __attribute__((weak));

#if !LIBMODBUS_VERSION_CHECK(3, 1, 9)
#define MODBUS_QUIRK_NONE 0
#define MODBUS_QUIRK_MAX_SLAVE (1 << 1)
#define MODBUS_QUIRK_REPLY_TO_BROADCAST (1 << 2)
#define MODBUS_QUIRK_ALL 0xFF
#endif

static int missing(void)
{
    errno = ENOSYS;
    return -1;
}

static int enable_quirks(modbus_t *ctx, unsigned int quirks_mask)
{
    return modbus_enable_quirks ? modbus_enable_quirks(ctx, quirks_mask) : missing();
}

static int disable_quirks(modbus_t *ctx, unsigned int quirks_mask)
{
    return modbus_disable_quirks ? modbus_disable_quirks(ctx, quirks_mask) : missing();
}

static int send_raw_request_tid(modbus_t *ctx, const uint8_t *raw_req, int raw_req_length, int tid)
{
    return modbus_send_raw_request_tid
               ? modbus_send_raw_request_tid(ctx, raw_req, raw_req_length, tid)
               : missing();
}

static int proxy(modbus_t *frontend_ctx, modbus_t *backend_ctx, const uint8_t *req, int req_length)
{
    return modbus_proxy ? modbus_proxy(frontend_ctx, backend_ctx, req, req_length) : missing();
}

#define modbus_enable_quirks enable_quirks
#define modbus_disable_quirks disable_quirks
#define modbus_send_raw_request_tid send_raw_request_tid
#define modbus_proxy proxy
