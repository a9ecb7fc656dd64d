/* Every byte may be the start of a frame, and each start costs a CRC: too much for Python. */

#define MAX_PDU 253
#define MAX_ADU (MAX_PDU + 3)
#define MIN_ADU 4

static uint16_t crc_table[256];

__attribute__((constructor)) static void make_crc_table(void)
{
    for (int byte = 0; byte < 256; byte++) {
        uint16_t crc = byte;
        for (int bit = 0; bit < 8; bit++)
            crc = crc >> 1 ^ (crc & 1 ? 0xA001 : 0);
        crc_table[byte] = crc;
    }
}

static uint16_t crc_step(uint16_t crc, uint8_t byte)
{
    return crc >> 8 ^ crc_table[(crc ^ byte) & 0xFF];
}

int crc16(const uint8_t *data, size_t size)
{
    uint16_t crc = 0xFFFF;
    while (size--)
        crc = crc_step(crc, *data++);
    return crc;
}

static int counted(const uint8_t *pdu, int size, int base, int at, int width)
{
    int count = 0;
    if (size < at + width)
        return UNFINISHED;
    while (width--)
        count = count << 8 | pdu[at++];
    return base + count;
}

/* Walks over the objects of a response. */
static int identification(const uint8_t *pdu, int size)
{
    int end = 7;
    if (size < end)
        return UNFINISHED;
    for (int objects = pdu[6]; objects > 0; objects--) {
        if (size < end + 2)
            return UNFINISHED;
        end += 2 + pdu[end + 1];
    }
    return end;
}

static int encapsulated(const uint8_t *pdu, int size, int is_response)
{
    if (size < 2)
        return UNFINISHED;
    if (pdu[1] != 0x0E)
        return 0;
    return is_response ? identification(pdu, size) : 4;
}

static int diagnostics(const uint8_t *pdu, int size)
{
    if (size < 3)
        return UNFINISHED;
    return pdu[1] || pdu[2] ? 5 : 0;
}

/* As the length rules of Python: 0 if nothing tells, UNFINISHED while it takes more bytes. */
static int pdu_length(const struct rule *rule, const uint8_t *pdu, int size)
{
    switch (rule->told) {
    case FIXED:
        return rule->base;
    case COUNTED:
        return counted(pdu, size, rule->base, rule->at, 1);
    case COUNTED_WIDE:
        return counted(pdu, size, rule->base, rule->at, 2);
    case DIAGNOSTICS:
        return diagnostics(pdu, size);
    case ENCAPSULATED_REQUEST:
    case ENCAPSULATED_RESPONSE:
        return encapsulated(pdu, size, rule->told == ENCAPSULATED_RESPONSE);
    default:
        return 0;
    }
}

static int end_by_length(const uint8_t *data, int size, int start, int length)
{
    int end;
    if (length < 0 || length > MAX_PDU)
        return NO_FRAME;
    end = start + length + 3;
    if (end > size)
        return UNFINISHED;
    return crc16(data + start, end - start) ? NO_FRAME : end;
}

/*
 * The longest fit up to the silence: an earlier one is chance, or data of the frame that were
 * chosen to look like its end.
 */
static int end_by_crc(struct scan *scan, const uint8_t *data, int size, int start, int state)
{
    uint16_t crc = 0xFFFF;
    int end = 0, most = size - start < MAX_ADU ? size - start : MAX_ADU;
    if (state == GOES_ON && most < MAX_ADU)
        return UNFINISHED;
    scan->fits = 0;
    for (int count = 1; count <= most; count++) {
        crc = crc_step(crc, data[start + count - 1]);
        if (crc == 0 && count >= MIN_ADU) {
            end = start + count;
            scan->fits++;
        }
    }
    if (end > 0)
        return end;
    return most == MAX_ADU ? NO_FRAME : UNFINISHED;
}

static int is_mei_type(uint8_t byte)
{
    return byte == 0x0D || byte == 0x0E;
}

/* Two bytes; some devices put the MEI type of function 43 beside the code. */
static int end_of_exception(const uint8_t *data, int size, int start)
{
    int end = end_by_length(data, size, start, 2);
    if (end != NO_FRAME || data[start + 1] != 0xAB)
        return end;
    if (!is_mei_type(data[start + 2]) && !is_mei_type(data[start + 3]))
        return NO_FRAME;
    return end_by_length(data, size, start, 3);
}

static int is_start(const struct scan *scan, uint8_t code)
{
    return scan->rules[code & 0x7F].is_known && (scan->is_client || code < 0x80);
}

/* Where the frame that begins at `start` ends, or what is said instead. */
static int frame_end(struct scan *scan, const uint8_t *data, int size, int start, int state)
{
    const uint8_t *pdu = data + start + 1;
    int head = size - start - 1, length = scan->length;
    if (head < 1)
        return UNFINISHED;
    /* As for starts that are searched for: it must not matter who found it. */
    if (start != scan->fresh && !is_start(scan, *pdu))
        return NO_FRAME;
    if (*pdu & 0x80)
        return scan->is_client ? end_of_exception(data, size, start) : NO_FRAME;
    if (head > MAX_PDU)
        head = MAX_PDU;
    if (scan->rules[*pdu].told != BY_PYTHON)
        length = pdu_length(&scan->rules[*pdu], pdu, head);
    else if (scan->asked != start)
        return ASK_PYTHON;
    scan->asked = -1;
    if (length == UNFINISHED)
        return head < MAX_PDU ? UNFINISHED : NO_FRAME;
    if (length == 0)
        return start == scan->fresh ? end_by_crc(scan, data, size, start, state) : NO_FRAME;
    return end_by_length(data, size, start, length);
}

/* Where a frame may begin, from `first` on; the last byte may always be a unit. */
static int next_start(const struct scan *scan, const uint8_t *data, int size, int first)
{
    int start = first;
    while (start + 1 < size && !is_start(scan, data[start + 1]))
        start++;
    return first <= scan->fresh && scan->fresh < start ? scan->fresh : start;
}

/*
 * Looks at one place only. Gives the end of the frame that begins there, or that it is UNFINISHED
 * or NO_FRAME; or ASK_PYTHON.
 */
int frame_at(struct scan *scan, const uint8_t *data, int size, int start, int fresh, int state)
{
    scan->start = start;
    scan->fresh = fresh;
    scan->fits = 1;
    return frame_end(scan, data, size, start, state);
}

/*
 * Looks for a frame from `start` on, or AT_END for one that ends with the data, past all that may
 * still be completed. Gives its end, and in scan->start where it begins; or that it is
 * UNFINISHED, and where it may begin; or ASK_PYTHON, and where.
 */
int next_frame(struct scan *scan, const uint8_t *data, int size, int start, int fresh, int state)
{
    scan->start = start;
    scan->fresh = fresh;
    while (scan->start < size) {
        int end = frame_end(scan, data, size, scan->start, state);
        if (end == ASK_PYTHON || (state == AT_END ? end == size : end != NO_FRAME))
            return end;
        scan->start = next_start(scan, data, size, scan->start + 1);
    }
    return UNFINISHED;
}
