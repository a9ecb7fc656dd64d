/* Where RTU frames begin and end: what Python calls in scan.c. */

/* How the length of a PDU is told. */
enum {
    BY_CRC,                /* by nothing in it: silence ends it, and its CRC fits */
    FIXED,                 /* `base` bytes */
    COUNTED,               /* `base`, and what the byte at `at` counts */
    COUNTED_WIDE,          /* `base`, and what the two bytes at `at` count */
    DIAGNOSTICS,           /* function 8: by its sub-function */
    ENCAPSULATED_REQUEST,  /* function 43: by its MEI type */
    ENCAPSULATED_RESPONSE,
    BY_PYTHON              /* by a rule that only Python knows */
};

/* What is known of the data. */
enum {
    GOES_ON,  /* more may follow at any time */
    SILENT,   /* silence followed */
    AT_END    /* silence followed, and only a frame that ends there is wanted */
};

/* What is said of a frame instead of its end. */
enum {
    NO_FRAME = 0,
    UNFINISHED = -1,
    ASK_PYTHON = -2  /* put the length into `length`, and `start` into `asked` */
};

struct rule {
    int is_known;  /* whether a frame with this function is looked for behind garbage */
    int told;
    int base;
    int at;
};

struct scan {
    int is_client;           /* responses come in, and so exceptions */
    int fresh;               /* where one should begin: after silence or a good frame */
    int start;               /* where the last one was found, or may begin */
    int asked;               /* where Python said how long the PDU is, or -1 */
    int length;
    int fits;                /* how many ends the last frame without a length may have */
    struct rule rules[128];  /* by function code */
};

int crc16(const uint8_t *data, size_t size);
int frame_at(struct scan *scan, const uint8_t *data, int size, int start, int fresh, int state);
int next_frame(struct scan *scan, const uint8_t *data, int size, int start, int fresh, int state);
