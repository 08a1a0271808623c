/* A controller in C that knows only the wire format and the key: SocketCAN, the CRC, SHA-256, AES and CMAC; nothing of hilrig.
 *
 *   cc -O2 -o keyed foreign_controller_keyed.c && ./keyed KEYFILE can0        (or "-": struct canfd_frame on stdin and stdout)
 */
#include <linux/can.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#define HELLO 0xFFFFFFFFu
static const double GAIN = -0.08;
static const int64_t PERIOD_NS = 50000000;

/* AES-128 without tables but the S-box, which is computed. */
static uint8_t sbox[256], round_key[176], sub1[16], sub2[16];
static uint8_t twice(uint8_t a) { return (uint8_t)(a << 1 ^ (a & 0x80 ? 0x1b : 0)); }

static void aes_key(const uint8_t *key) {
    uint8_t p = 1, q = 1, rcon = 1;
    do { /* p runs through all but 0, q is its inverse */
        p = (uint8_t)(p ^ twice(p));
        q ^= (uint8_t)(q << 1); q ^= (uint8_t)(q << 2); q ^= (uint8_t)(q << 4); q ^= q & 0x80 ? 0x09 : 0;
#define ROT(x, n) (uint8_t)((x) << (n) | (x) >> (8 - (n)))
        sbox[p] = (uint8_t)(q ^ ROT(q, 1) ^ ROT(q, 2) ^ ROT(q, 3) ^ ROT(q, 4) ^ 0x63);
    } while (p != 1);
    sbox[0] = 0x63;
    memcpy(round_key, key, 16);
    for (int i = 16; i < 176; i += 4) {
        uint8_t t[4];
        memcpy(t, round_key + i - 4, 4);
        if (i % 16 == 0) {
            uint8_t first = t[0];
            t[0] = sbox[t[1]] ^ rcon; t[1] = sbox[t[2]]; t[2] = sbox[t[3]]; t[3] = sbox[first];
            rcon = twice(rcon);
        }
        for (int j = 0; j < 4; j++) round_key[i + j] = round_key[i - 16 + j] ^ t[j];
    }
}

static void aes(uint8_t *s) {
    for (int j = 0; j < 16; j++) s[j] ^= round_key[j];
    for (int round = 1; round <= 10; round++) {
        uint8_t t[16];
        for (int j = 0; j < 16; j++) t[j] = sbox[s[(j + 4 * (j % 4)) % 16]]; /* SubBytes, ShiftRows */
        for (int c = 0; c < 16; c += 4) {
            uint8_t all = t[c] ^ t[c + 1] ^ t[c + 2] ^ t[c + 3];
            for (int j = 0; j < 4; j++)
                s[c + j] = round < 10 ? t[c + j] ^ all ^ twice(t[c + j] ^ t[c + (j + 1) % 4]) : t[c + j];
        }
        for (int j = 0; j < 16; j++) s[j] ^= round_key[16 * round + j];
    }
}

static void doubled(const uint8_t *in, uint8_t *out) {
    for (int j = 0; j < 16; j++) out[j] = (uint8_t)(in[j] << 1 | (j < 15 ? in[j + 1] >> 7 : 0));
    if (in[0] & 0x80) out[15] ^= 0x87;
}

/* The first 8 bytes of CMAC-AES(key, session | data). */
static void code(const uint8_t *session, const uint8_t *data, int length, uint8_t *tag) {
    uint8_t message[8 + 64], state[16] = {0};
    int n = 8 + length, at = 0;
    memcpy(message, session, 8);
    memcpy(message + 8, data, (size_t)length);
    for (; n - at > 16; at += 16) {
        for (int j = 0; j < 16; j++) state[j] ^= message[at + j];
        aes(state);
    }
    int whole = n - at == 16;
    for (int j = 0; j < 16; j++)
        state[j] ^= (at + j < n ? message[at + j] : at + j == n ? 0x80 : 0) ^ (whole ? sub1[j] : sub2[j]);
    aes(state);
    memcpy(tag, state, 8);
}

/* SHA-256 whose constants are computed: the first bits behind the point of roots of primes. */
static struct { uint32_t h[8]; uint8_t block[64]; uint64_t length; } hash;
static uint32_t round_constant[64], first_state[8];

static uint32_t root_bits(int prime, int cube) { /* by bisection in whole numbers: floor(2^32 root) */
    unsigned __int128 low = 0, high = (unsigned __int128)32 << 32;
    while (high - low > 1) {
        unsigned __int128 middle = (low + high) / 2, power = middle * middle;
        int above = cube ? power * middle >= (unsigned __int128)prime << 96 && middle : power >= (unsigned __int128)prime << 64;
        if (above) high = middle; else low = middle;
    }
    return (uint32_t)low;
}

static void hash_constants(void) {
    for (int prime = 2, n = 0; n < 64; prime++) {
        int divided = 0;
        for (int d = 2; d * d <= prime; d++) divided |= prime % d == 0;
        if (divided) continue;
        if (n < 8) first_state[n] = root_bits(prime, 0);
        round_constant[n++] = root_bits(prime, 1);
    }
}

static void hash_begin(void) { memcpy(hash.h, first_state, sizeof first_state); hash.length = 0; }

static void hash_block(void) {
    uint32_t w[64], s[8];
#define RIGHT(x, n) ((x) >> (n) | (x) << (32 - (n)))
    for (int i = 0; i < 16; i++)
        w[i] = (uint32_t)hash.block[4 * i] << 24 | (uint32_t)hash.block[4 * i + 1] << 16 | (uint32_t)hash.block[4 * i + 2] << 8 | hash.block[4 * i + 3];
    for (int i = 16; i < 64; i++)
        w[i] = w[i - 16] + w[i - 7] + (RIGHT(w[i - 15], 7) ^ RIGHT(w[i - 15], 18) ^ w[i - 15] >> 3)
             + (RIGHT(w[i - 2], 17) ^ RIGHT(w[i - 2], 19) ^ w[i - 2] >> 10);
    memcpy(s, hash.h, sizeof s);
    for (int i = 0; i < 64; i++) {
        uint32_t a = s[7] + (RIGHT(s[4], 6) ^ RIGHT(s[4], 11) ^ RIGHT(s[4], 25)) + ((s[4] & s[5]) ^ (~s[4] & s[6])) + round_constant[i] + w[i];
        uint32_t b = (RIGHT(s[0], 2) ^ RIGHT(s[0], 13) ^ RIGHT(s[0], 22)) + ((s[0] & s[1]) ^ (s[0] & s[2]) ^ (s[1] & s[2]));
        memmove(s + 1, s, 28);
        s[4] += a;
        s[0] = a + b;
    }
    for (int i = 0; i < 8; i++) hash.h[i] += s[i];
}

static void hash_byte(uint8_t byte) {
    hash.block[hash.length++ % 64] = byte;
    if (hash.length % 64 == 0) hash_block();
}

static void hash_end(uint8_t *first8) {
    uint64_t bits = 8 * hash.length;
    for (hash_byte(0x80); hash.length % 64 != 56;) hash_byte(0);
    for (int i = 56; i >= 0; i -= 8) hash_byte((uint8_t)(bits >> i));
    for (int i = 0; i < 8; i++) first8[i] = (uint8_t)(hash.h[i / 4] >> (24 - 8 * (i % 4)));
}

static uint16_t crc(const uint8_t *data, int length) {
    uint16_t c = 0xFFFF;
    for (int i = 0; i < length; i++) {
        c ^= (uint16_t)(data[i] << 8);
        for (int b = 0; b < 8; b++) c = (uint16_t)(c & 0x8000 ? c << 1 ^ 0x1021 : c << 1);
    }
    return c;
}

static int whole(int fd, struct canfd_frame *frame) { /* a pipe may give less than a frame at once */
    size_t got = 0;
    while (got < sizeof *frame) {
        ssize_t n = read(fd, (char *)frame + got, sizeof *frame - got);
        if (n <= 0) return 0;
        got += (size_t)n;
        if (got == CAN_MTU && fd != 0) return 1; /* a classic frame of a socket */
    }
    return 1;
}

int main(int argc, char **argv) {
    uint8_t key[16], zero[16] = {0}, session[8] = {0};
    FILE *file = argc == 3 ? fopen(argv[1], "r") : NULL;
    for (int i = 0; i < 16; i++)
        if (!file || fscanf(file, "%2hhx", &key[i]) != 1) return fprintf(stderr, "usage: %s KEYFILE INTERFACE|-\n", argv[0]), 2;
    fclose(file);
    aes_key(key);
    aes(zero);
    doubled(zero, sub1);
    doubled(sub1, sub2);
    hash_constants();
    hash_begin();
    int in = 0, out = 1;
    if (strcmp(argv[2], "-")) {
        struct sockaddr_can address = {.can_family = AF_CAN, .can_ifindex = (int)if_nametoindex(argv[2])};
        int on = 1;
        in = out = socket(AF_CAN, SOCK_RAW, CAN_RAW);
        setsockopt(in, SOL_CAN_RAW, CAN_RAW_FD_FRAMES, &on, sizeof on);
        if (bind(in, (struct sockaddr *)&address, sizeof address)) return perror(argv[2]), 1;
    }
    struct canfd_frame frame, answer;
    uint32_t sent = 0, seq, counter;
    uint64_t heard = 0;
    int64_t stamp, sample_ns = -1;
    float y = 0;
    int known = 0, begun = 0;
    while (whole(in, &frame)) {
        const uint8_t *d = frame.data;
        if (frame.can_id != 0x100 || frame.len < 40 || d[2] != 0x31 || !(d[26] & 0x80)) continue;
        int count = (d[3] & 0x3F) * d[25] + (d[26] & 0x7F), end = 32 + 4 * count;
        if (end + 8 > frame.len) continue;
        memcpy(&seq, d + 4, 4); /* this machine is little endian, as the wire is */
        memcpy(&stamp, d + 16, 8);
        memcpy(&counter, d + 28, 4);
        uint64_t now = counter + ((uint64_t)(seq != HELLO) << 32); /* it begins again at slot 0 */
        int fresh = seq == HELLO && (!begun || memcmp(d + 8, session, 8));
        uint8_t tag[8];
        code(fresh ? d + 8 : session, d + 2, end - 2, tag);
        if (now <= (fresh ? 0 : heard) || memcmp(tag, d + end, 8)) continue; /* replayed, or forged */
        if (fresh) {
            memcpy(session, d + 8, 8);
            begun = 1; known = 0; sample_ns = -1;
        }
        if (fresh || (now >> 32 && !(heard >> 32))) sent = 0;
        heard = now;
        for (int i = 2; i < end; i++) hash_byte(i == 26 ? d[i] & 0x7F : d[i]); /* without the flag TAGGED */
        if (!(d[3] & 0x80)) { /* not EMPTY: there is a sample, the newest first */
            memcpy(&y, d + 32, 4);
            sample_ns = stamp;
            known = 1;
        }
        if (d[3] & 0x40) continue; /* MORE */
        int64_t now_ns = seq == HELLO ? 0 : (int64_t)seq * PERIOD_NS;
        float r = 0;
        if (d[26] & 0x7F) memcpy(&r, d + 32 + 4 * (count - 1), 4);
        float u = known ? (float)(GAIN * (y - r)) : 0;
        int16_t tau = known ? (int16_t)((now_ns - sample_ns) / PERIOD_NS) : -1;
        memset(&answer, 0, sizeof answer);
        answer.can_id = 0x140;
        answer.len = 64;
        uint8_t *a = answer.data;
        a[2] = 0x32; a[3] = 0x80; /* TAGGED, selection 0: one row for every delay */
        memcpy(a + 4, &seq, 4);
        hash_end(a + 8); /* what was asked, in eight bytes */
        hash_begin();
        memcpy(a + 16, &sample_ns, 8);
        memcpy(a + 24, &now_ns, 8);
        memcpy(a + 32, &tau, 2);
        a[34] = a[35] = 1;
        sent++;
        memcpy(a + 36, &sent, 4);
        memcpy(a + 40, &u, 4);
        code(session, a + 2, 42, a + 44);
        uint16_t sum = crc(a + 2, 62);
        memcpy(a, &sum, 2);
        if (write(out, &answer, sizeof answer) != sizeof answer) return 1;
    }
    return 0;
}
