/* A controller in C that knows only wire version 2 and the key: SocketCAN, the CRC, AES and CMAC; nothing of hilrig.
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
    int in = 0, out = 1;
    if (strcmp(argv[2], "-")) {
        struct sockaddr_can address = {.can_family = AF_CAN, .can_ifindex = (int)if_nametoindex(argv[2])};
        int on = 1;
        in = out = socket(AF_CAN, SOCK_RAW, CAN_RAW);
        setsockopt(in, SOL_CAN_RAW, CAN_RAW_FD_FRAMES, &on, sizeof on);
        if (bind(in, (struct sockaddr *)&address, sizeof address)) return perror(argv[2]), 1;
    }
    struct canfd_frame frame, answer;
    uint32_t heard = 0, sent = 0, seq, freshness;
    int64_t stamp, sample_ns = -1;
    float y = 0;
    int known = 0, begun = 0;
    while (whole(in, &frame)) {
        const uint8_t *d = frame.data;
        if (frame.can_id != 0x100 || frame.len < 40 || d[2] != 0x21 || !(d[26] & 0x80)) continue;
        int count = (d[3] & 0x3F) * d[25] + (d[26] & 0x7F), end = 28 + 4 * count + 4;
        if (end + 8 > frame.len) continue;
        memcpy(&seq, d + 4, 4); /* this machine is little endian, as the wire is */
        memcpy(&stamp, d + 16, 8);
        memcpy(&freshness, d + end - 4, 4);
        int fresh = seq == HELLO && (!begun || memcmp(d + 8, session, 8));
        uint8_t tag[8];
        code(fresh ? d + 8 : session, d + 2, end - 2, tag);
        if (freshness <= (fresh ? 0 : heard) || memcmp(tag, d + end, 8)) continue; /* replayed, or forged */
        if (fresh) {
            memcpy(session, d + 8, 8);
            begun = 1; sent = 0; known = 0; sample_ns = -1;
        }
        heard = freshness;
        if (!(d[3] & 0x80)) { /* not EMPTY: there is a sample, the newest first */
            memcpy(&y, d + 28, 4);
            sample_ns = stamp;
            known = 1;
        }
        if (d[3] & 0x40) continue; /* MORE */
        int64_t now_ns = seq == HELLO ? 0 : (int64_t)seq * PERIOD_NS;
        float r = 0;
        if (d[26] & 0x7F) memcpy(&r, d + 28 + 4 * (count - 1), 4);
        float u = known ? (float)(GAIN * (y - r)) : 0;
        int16_t tau = known ? (int16_t)((now_ns - sample_ns) / PERIOD_NS) : -1;
        memset(&answer, 0, sizeof answer);
        answer.can_id = 0x140;
        answer.len = 64;
        uint8_t *a = answer.data;
        a[2] = 0x22; a[3] = 0x80; /* TAGGED, selection 0: one row for every delay */
        memcpy(a + 4, &seq, 4);
        memcpy(a + 8, d + 8, 8); /* the nonce of the question */
        memcpy(a + 16, &sample_ns, 8);
        memcpy(a + 24, &now_ns, 8);
        memcpy(a + 32, &tau, 2);
        a[34] = a[35] = 1;
        memcpy(a + 36, &u, 4);
        sent++;
        memcpy(a + 40, &sent, 4);
        code(session, a + 2, 42, a + 44);
        uint16_t sum = crc(a + 2, 62);
        memcpy(a, &sum, 2);
        if (write(out, &answer, sizeof answer) != sizeof answer) return 1;
    }
    return 0;
}
