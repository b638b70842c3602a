/* The line of a board that says readings unasked: 57600 baud, 8N1, a clock of milliseconds, "I" and a line feed as the
   only question, and the CRC-8 (0x07) of all before the last space of a line. Arduino Uno (ATmega328P, 16 MHz).

   A line: crc = 0; say what it holds; say_check(). The host's side: rigs/transports/_serial_link.py. */
#include <avr/interrupt.h>
#include <avr/io.h>

static volatile unsigned long milliseconds;
static volatile unsigned char asked; /* "I" has come; a line feed makes it a question */
static volatile unsigned char question;
static unsigned char crc;

ISR(TIMER1_COMPA_vect) { milliseconds++; }

ISR(USART_RX_vect) {
    unsigned char byte = UDR0;
    if (byte == '\n') { question |= asked; asked = 0; }
    else if (byte != '\r') asked = byte == 'I';
}

static void put(char byte) {
    while (!(UCSR0A & (1 << UDRE0))) {}
    UDR0 = byte;
    crc ^= byte;
    for (unsigned char bit = 0; bit < 8; bit++) crc = crc & 0x80 ? crc << 1 ^ 0x07 : crc << 1;
}

static void say(const char *text) { for (; *text; text++) put(*text); }

static void say_number(unsigned long number) {
    char digits[10];
    unsigned char length = 0;
    do digits[length++] = '0' + number % 10; while (number /= 10);
    while (length) put(digits[--length]);
}

static unsigned long now(void) {
    cli();
    unsigned long at = milliseconds;
    sei();
    return at;
}

static void say_check(void) {
    unsigned char check = crc;
    put(' ');
    put("0123456789ABCDEF"[check >> 4]);
    put("0123456789ABCDEF"[check & 15]);
    put('\n');
}

static unsigned char was_asked(void) {
    if (!question)
        return 0;
    question = 0; /* only where it was seen: one that comes meanwhile is kept for the next turn */
    return 1;
}

static void begin(void) {
    UCSR0A = 1 << U2X0;
    UBRR0 = 34; /* 57143 baud, 0.8 % slow */
    UCSR0B = (1 << RXEN0) | (1 << TXEN0) | (1 << RXCIE0);
    UCSR0C = 3 << UCSZ00;
    TCCR1B = (1 << WGM12) | (1 << CS11) | (1 << CS10); /* clear on match, clock / 64 */
    OCR1A = 249;                                       /* 1 kHz */
    TIMSK1 = 1 << OCIE1A;
    sei();
}
